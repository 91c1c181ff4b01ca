"""An adaptive staircase: the stimulus that is just noticed, from right and wrong answers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from messages.errors import UsageError


@dataclass
class Staircase:
    """A transformed up-down staircase, which seeks a stimulus by answers (Levitt 1971).

    After `down` successive right answers the stimulus becomes smaller by one step, after each wrong
    one larger; it settles where an answer is right with probability 0.5^(1/`down`): 0.5, 0.707 for
    two, 0.794 for three. Steps are factors, as differences that are just noticed are.

    Levitt, H.: Transformed up-down methods in psychoacoustics, J. Acoust. Soc. Am. 49 (1971) 467.

    Parameters
    ----------
    value : float
        First stimulus, above 0; easily noticed.
    down : int
        Right answers in a row before the stimulus becomes smaller.
    factor : float
        Factor of a step, above 1; after the second reversal its square root, after the fourth its
        fourth root.
    reversals : int
        Reversals until the end.

    Attributes
    ----------
    values : list of float
        Stimuli so far, the present one at the end.
    turns : list of float
        Stimuli at the reversals.

    Examples
    --------
    >>> stairs = Staircase(100.0, down=1)
    >>> while not stairs.done:
    ...     _ = stairs.answer(stairs.value > 20.0)  # who notices 20 notices it always
    >>> 16.0 < stairs.threshold < 25.0
    True
    """

    value: float
    down: int = 2
    factor: float = 2.0
    reversals: int = 12
    values: list[float] = field(init=False)
    turns: list[float] = field(init=False, default_factory=list)
    _right: int = field(init=False, default=0)
    _direction: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        """Check the parameters."""
        real = all(
            isinstance(one, int | float | np.number)
            for one in (self.value, self.factor)
        )
        whole = all(
            isinstance(one, int | np.integer) for one in (self.down, self.reversals)
        )
        if not (
            real
            and whole
            and 0.0 < self.value < np.inf
            and 1.0 < self.factor < np.inf
            and self.down >= 1
            and self.reversals >= 2
        ):
            raise UsageError(
                f"staircase: value {self.value!r} (finite, above 0), factor {self.factor!r}"
                f" (finite, above 1), down {self.down!r} (whole, at least 1), reversals"
                f" {self.reversals!r} (whole, at least 2)"
            )
        self.values = [self.value]

    @property
    def done(self) -> bool:
        """Whether all reversals are there."""
        return len(self.turns) >= self.reversals

    def answer(self, right: bool) -> float:
        """Note an answer to the present stimulus; return the next stimulus.

        Parameters
        ----------
        right : bool
            Whether the answer was right.

        Returns
        -------
        float
            The next stimulus.
        """
        self._right = self._right + 1 if right else 0
        direction = -1 if self._right == self.down else 1 if not right else 0
        if direction:
            if self._direction and direction != self._direction:
                self.turns.append(self.value)
            self._direction = direction
            turns = len(self.turns)
            step = self.factor ** (1.0 if turns < 2 else 0.5 if turns < 4 else 0.25)
            self.value *= step**direction
            self._right = 0
        self.values.append(self.value)
        return self.value

    @property
    def threshold(self) -> float:
        """Geometric mean of the reversals behind the fourth, an even number of them.

        Raises UsageError before there are two.
        """
        late = self.turns[4:] if len(self.turns) > 5 else self.turns
        late = late[len(late) % 2 :]
        if not late:
            raise UsageError(
                f"staircase: {len(self.turns)} reversals; a threshold needs two"
            )
        return float(np.exp(np.mean(np.log(late))))
