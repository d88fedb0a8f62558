"""Where samples lie: domains, grids, affine maps, freeze masks and splines."""
