"""A cruise's YAML files in, frozen models out."""
