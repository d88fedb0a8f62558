"""Undo and redo over states that never change."""

from __future__ import annotations

from typing import Generic, TypeVar

S = TypeVar("S")


class History(Generic[S]):
    """A present state, those before it, and those that were undone.

    It has no end, and merges nothing: what is pushed is a step.

    Parameters
    ----------
    present : object
        The first state. States are kept as they are, so they must never change.
    """

    def __init__(self, present: S) -> None:
        self._present = present
        self._past: list[S] = []
        self._future: list[S] = []

    @property
    def present(self) -> S:
        """The state as it is now."""
        return self._present

    @property
    def can_undo(self) -> bool:
        """Return whether there is a state before this one."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Return whether a state was undone, and nothing was pushed since."""
        return bool(self._future)

    def push(self, state: S) -> None:
        """Go on to another state; what was undone is gone."""
        self._past.append(self._present)
        self._present = state
        self._future.clear()

    def amend(self, state: S) -> None:
        """Put another state in the place of the present one, without a step."""
        self._present = state

    def undo(self) -> S:
        """Go back to the state before; without one, stay."""
        if self._past:
            self._future.append(self._present)
            self._present = self._past.pop()
        return self._present

    def redo(self) -> S:
        """Go to the state that was undone last; without one, stay."""
        if self._future:
            self._past.append(self._present)
            self._present = self._future.pop()
        return self._present
