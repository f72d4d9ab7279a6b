"""Files that appear whole or not at all."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A path beside `path` to write to: renamed to `path` when the block ends well, removed when it does not.

    Its ending is that of `path`, by which writers choose the format. Makes the folder. Raises OSError where it cannot.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_json(path: str | Path, value: object) -> Path:
    """Write plain values as JSON, whole or not at all; NaN is refused with a ValueError."""
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return Path(path)


def read_json(path: str | Path) -> object:
    """The plain values of a JSON file; raises ValueError naming the file when it is none."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{Path(path).name} must be a readable JSON file; got {error}") from None
