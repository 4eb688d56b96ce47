"""Data sets on disk: get published ones, check what is there, make a scene of camera files, export one."""
