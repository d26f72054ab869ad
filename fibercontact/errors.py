"""What a user can mend: the base of every error that the command line prints as one line."""

__all__ = ["NO_CACHE", "UserError"]

NO_CACHE = "no folder to keep compiled code in"
"""How the warning begins that kernels are compiled in every process."""


class UserError(ValueError):
    """Something asked for or given cannot be used; the message names it and says why."""
