"""Methods for all contacts at once, one file each: what one might use instead of sweeps."""
