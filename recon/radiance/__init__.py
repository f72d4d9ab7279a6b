"""The radiance field: an encoding of space, packed volume rendering, a canonical field and what bends rays into it."""
