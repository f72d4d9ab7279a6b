"""Virtual elastic objects: tracked points and known forces in, per-point material out.

Everything a notebook needs is a name of this package. Names load on first use, so `import veo_ti` takes milliseconds.
"""

from importlib import import_module

__version__ = "0.1.0"

_HOME = {
    "Lame": "sim.lame",
    "Observation": "veo_ti.observation",
    "RestCloud": "sim.cloud",
    "VirtualElasticObject": "veo_ti.object",
    "examine": "veo_ti.doctor",
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
