"""Block Gauss–Seidel: the outer loop over any local solver."""
