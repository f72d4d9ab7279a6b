"""Virtual elastic objects: tracked points and known forces in, per-point material out.

Everything a notebook needs is a name of this package. Names load on first use, so `import veo_ti` takes milliseconds.
"""

from importlib import import_module

__version__ = "0.1.0"

_HOME = {
    "BeamModel": "veo_ti.beam",
    "CloudOptions": "sim.cloud",
    "Contact": "sim.terms.contact",
    "FitOptions": "sim.basis",
    "IdentifyOptions": "veo_ti.identification",
    "Lame": "sim.lame",
    "MarkedPose": "veo_ti.markers",
    "NewtonOptions": "sim.newton",
    "Observation": "veo_ti.observation",
    "RestCloud": "sim.cloud",
    "Sphere": "sim.terms.shapes",
    "VirtualElasticObject": "veo_ti.object",
    "contact_alpha": "sim.terms.contact",
    "error_map": "veo_ti.view",
    "evaluate": "veo_ti.evaluation",
    "examine": "veo_ti.doctor",
    "frames_strip": "veo_ti.view",
    "identify": "veo_ti.identification",
    "identify_beam": "veo_ti.beam",
    "identify_modulus": "veo_ti.markers",
    "lame_map": "veo_ti.view",
    "read_settled": "veo_ti.beam",
    "refined_limit": "veo_ti.markers",
    "sample_box": "veo_ti.body",
    "sample_mesh": "veo_ti.body",
    "save_picture": "veo_ti.view",
    "sensitivity_map": "veo_ti.view",
    "tie_markers": "veo_ti.body",
    "turntable": "veo_ti.view",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
