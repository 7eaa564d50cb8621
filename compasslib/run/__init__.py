"""Around a run and around each job: what may be written, what was recorded, what was stopped."""
