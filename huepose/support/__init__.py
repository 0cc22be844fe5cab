"""What every room needs and none owns: errors that say what to do, compiled kernels, progress."""
