"""Ground truth: the convex problem of a fixed slip term, Cadoux's fixed point, accepted references."""
