"""The contract of a local solver, checked: exactness, honesty, invariance, data that are not finite."""
