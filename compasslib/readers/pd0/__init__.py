"""RDI's PD0 format."""
