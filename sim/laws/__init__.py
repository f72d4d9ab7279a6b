"""Constitutive laws: each a class of Taichi functions psi, piola, dpiola of the deformation gradient."""
