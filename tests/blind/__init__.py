"""Blind trials: measurements by an independent finite-element simulator with an effect hidden in each.

Nothing that makes a trial imports the toolkit; only `blind.judging` does, to ask it for its verdict.
"""
