"""Independent float64 twins of the kernels, built on shapely. Arrays are batch-first here: `(*batch, robots, 2)`."""
