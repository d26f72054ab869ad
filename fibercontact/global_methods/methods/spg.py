"""Spectral projected gradient on all contacts at once, the slip term that of every iterate.

Equation: `x ← x + t (P_K(x − a ỹ) − x)` with `ỹ = A x + c + mu |y_T| e`; a is a step length of Barzilai and
Borwein, t is 1 unless the quadratic with the slip term of the iterate would grow beyond its last ten changes, and
else its minimum.
Reference: Birgin, Martínez and Raydan, SIAM J. Optim. 10, 2000; Zhou, Gao and Dai, Comput. Optim. Appl. 35, 2006.
There is no objective, hence no proof. One product with W an iteration, thousands of iterations on stiff assemblies.
"""

from fibercontact.global_methods.cadoux import followed
from fibercontact.global_methods.contract import GlobalMethod
from fibercontact.global_methods.spectral import begin_spectral, spectral

__all__ = ["solver"]

solver = GlobalMethod(followed(begin_spectral, spectral))
