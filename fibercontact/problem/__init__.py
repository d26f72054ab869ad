"""Incremental problems: their data, how a candidate solution is measured, and their files."""
