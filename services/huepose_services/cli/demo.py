"""`huepose demo`."""
