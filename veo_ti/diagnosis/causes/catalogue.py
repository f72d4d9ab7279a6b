"""Every known cause, in the order in which `veo causes` lists them."""

from veo_ti.diagnosis.causes import (
    clocks,
    dynamics,
    geometry,
    history,
    loads,
    material,
    measurement,
    other_loads,
    surroundings,
)
from veo_ti.diagnosis.causes.base import Cause

CATALOGUE: tuple[Cause, ...] = (
    material.StrainStiffening(),
    material.VolumetricLaw(),
    material.FibreAnisotropy(),
    history.Viscoelasticity(),
    history.PermanentSet(),
    history.Softening(),
    history.StiffnessDrift(),
    dynamics.Inertia(),
    dynamics.Damping(),
    geometry.AddedMass(),
    other_loads.ForceDirection(),
    other_loads.ForceOffset(),
    other_loads.ForceMagnitude(),
    clocks.ForceTiming(),
    other_loads.FollowerLoad(),
    loads.HiddenForce(),
    loads.HiddenTether(),
    surroundings.HiddenContact(),
    geometry.Disconnection(),
    surroundings.SupportCompliance(),
    surroundings.Prestress(),
    loads.GravityDirection(),
    measurement.CameraScale(),
    measurement.CorrespondenceSlip(),
    clocks.ClockDrift(),
)
