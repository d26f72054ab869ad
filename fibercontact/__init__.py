"""fibercontact: a comparative benchmark of frictional contact solvers on thin elastic rods."""

__version__ = "0.1.0"
