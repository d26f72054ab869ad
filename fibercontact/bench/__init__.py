"""The benchmark: problems replayed through local solvers, rows, tables and figures."""
