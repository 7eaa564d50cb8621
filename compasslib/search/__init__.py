"""Where a recording and its simulation differ, what physics was left out, and how sure that is.

``diagnosis.diagnose`` searches a mooring, ``moored.diagnose`` the same as the workflow asks for it, ``recordings`` all
else. Nothing is imported here: the jobs that only correct need no search.
"""
