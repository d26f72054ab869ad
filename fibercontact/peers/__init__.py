"""Other people's solvers of whole problems, each run in a process of its own."""
