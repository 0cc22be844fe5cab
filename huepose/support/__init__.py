"""What every package needs: errors that say what to do, files, caches, compiled kernels, progress."""
