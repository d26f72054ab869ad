"""Local solvers: one contact, one file each."""
