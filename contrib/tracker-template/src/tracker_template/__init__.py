"""Relative bearing: the direction to a target counted from the bow of the observer.

Nothing is imported here: every `tracker list` imports this package, and must stay quick.
"""
