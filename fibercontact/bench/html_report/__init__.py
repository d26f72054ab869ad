"""Runs as one self-contained HTML page: read back, drawn by plotly, laid out by a jinja2 template."""
