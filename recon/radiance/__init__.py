"""The radiance field: an encoding of space, packed volume rendering, a canonical field and what bends rays into it."""

import sim.runtime  # noqa: F401, it keeps Taichi quiet, which must be said before Taichi is first imported
