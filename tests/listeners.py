"""A listener for runs of which nobody watches the progress."""


class Silent:
    """Keeps the notes."""

    def __init__(self):
        self.notes = []

    def now(self, problem, solver):
        pass

    def row(self, unit, row):
        pass

    def note(self, text):
        self.notes.append(text)
