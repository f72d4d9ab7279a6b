"""Every known cause, in the order in which `veo causes` lists them."""

from veo_ti.diagnosis.causes import history, loads, material, measurement
from veo_ti.diagnosis.causes.base import Cause

CATALOGUE: tuple[Cause, ...] = (
    material.StrainStiffening(),
    material.VolumetricLaw(),
    material.FibreAnisotropy(),
    history.Viscoelasticity(),
    history.PermanentSet(),
    history.Softening(),
    history.StiffnessDrift(),
    loads.ForceDirection(),
    loads.ForceOffset(),
    loads.ForceMagnitude(),
    loads.ForceTiming(),
    loads.FollowerLoad(),
    loads.HiddenForce(),
    loads.HiddenTether(),
    loads.GravityDirection(),
    measurement.CameraScale(),
    measurement.CorrespondenceSlip(),
    loads.ClockDrift(),
)
