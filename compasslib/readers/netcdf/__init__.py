"""NetCDF of others: OceanSITES, IMOS, EPIC, what dolfyn and stglib write, CF by standard names, and our own product."""
