"""What a person sees while a command works: on standard error, so that results can be piped."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

console = Console(stderr=True)


@contextmanager
def waiting(name: str) -> Iterator[Callable[[str], None]]:
    """A spinner with the time that has passed, for work whose length nobody knows; it takes what is being done."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(name, total=None)
        yield lambda text: bar.update(task, description=f"{name}: {text.replace('_', ' ')}")
