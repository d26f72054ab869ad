"""One file a local solver; a file put here is a built-in solver, named after it."""
