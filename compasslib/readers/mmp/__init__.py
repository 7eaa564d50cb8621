"""The Falmouth 3D-ACM current meter on a McLane moored profiler."""
