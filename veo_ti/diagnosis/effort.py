"""How much a diagnosis may compute: counted, so that the same data give the same answer on any machine."""

from dataclasses import dataclass

STEPS = 1500.0  # docs/diagnosis.md says how long they take
LINEARISATION = 4.0  # steps that one takes as long as


@dataclass(eq=False)
class Effort:
    """How many of Newton's steps of all frames were made, and how many may be."""

    most: float = STEPS
    spent: float = 0.0

    def spend(self, steps: float) -> None:
        """So many more."""
        self.spent += float(steps)

    @property
    def over(self) -> bool:
        """Whether there is none left."""
        return self.spent >= self.most
