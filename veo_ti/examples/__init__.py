"""The embedded example: a soft body under an air jet, made by an independent finite-element simulator."""
