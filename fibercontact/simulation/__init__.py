"""Simulation: the step from rods to impulses, the scenes, and the corpus made of them."""
