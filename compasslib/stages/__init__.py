"""The stages of the pipeline, and what each of them needs from the cruise's configuration."""
