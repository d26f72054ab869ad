"""Cadoux's fixed point, its convex problems solved by spectral projected gradient.

Equation: `s ← mu |y_T(s)|`, y(s) that of `min ½ xᵀA x + (c + s e)ᵀx` over the cones, to a tenth of the residual at
hand.
Reference: Cadoux, thesis, 2009; Acary, Cadoux, Lemaréchal and Malick, ZAMM 91, 2011; Birgin, Martínez and Raydan,
SIAM J. Optim. 10, 2000.
The convex problems are solved for sure, if slowly on stiff assemblies; the fixed point may cycle.
"""

from fibercontact.global_methods.cadoux import cadoux
from fibercontact.global_methods.contract import GlobalMethod
from fibercontact.global_methods.spectral import begin_spectral, spectral

__all__ = ["solver"]

solver = GlobalMethod(cadoux(begin_spectral, spectral))
