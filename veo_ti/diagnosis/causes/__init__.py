"""The catalogue of causes."""

from veo_ti.diagnosis.causes.base import Cause, Change, Parameter
from veo_ti.diagnosis.causes.catalogue import CATALOGUE

__all__ = ["CATALOGUE", "Cause", "Change", "Parameter"]
