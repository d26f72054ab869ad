"""What a user can mend: the base of every error that the command line prints as one line."""

__all__ = ["UserError"]


class UserError(ValueError):
    """Something asked for or given cannot be used; the message names it and says why."""
