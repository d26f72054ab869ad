"""Accelerated projected gradient on all contacts at once, the slip term that of every iterate.

Equation: `x⁺ = P_K(z − (A z + c + mu |y_T(z)| e) / L)`, `z = x⁺ + beta (x⁺ − x)` with Nesterov's beta, L by
backtracking, the momentum dropped when a step goes uphill.
Reference: Mazhar, Heyn, Negrut and Tasora, ACM TOG 34(3), 2015, who solve the convexified law without the slip term;
O'Donoghue and Candès, Found. Comput. Math. 15, 2015, for the restart.
There is no objective, hence no proof. One product with W an iteration; slow where weak directions of W decide.
"""

from fibercontact.global_methods.accelerated import accelerated, begin_accelerated
from fibercontact.global_methods.cadoux import followed
from fibercontact.global_methods.contract import GlobalMethod

__all__ = ["solver"]

solver = GlobalMethod(followed(begin_accelerated, accelerated))
