"""The parts of a glTF file that are not supported. They are collected, so that one error lists them all."""

import dataclasses
from pathlib import Path

from jaxdr.callers_line import warn


@dataclasses.dataclass
class Problems:
    """`unsupported`: things that are left out with `ignore_unsupported`, and are errors without. `notes`: warnings."""

    path: Path
    unsupported: dict[str, None] = dataclasses.field(default_factory=dict)  # in order, each once
    notes: dict[str, None] = dataclasses.field(default_factory=dict)

    def leave_out(self, message: str) -> None:
        """Note, once, something that is not supported, and what happens instead."""
        self.unsupported[message] = None

    def note(self, message: str) -> None:
        """Note, once, something that is read but does not look exactly as it should."""
        self.notes[message] = None

    def check(self, ignore_unsupported: bool) -> None:
        """Raise one ValueError that lists what is not supported; with `ignore_unsupported` warn of each instead."""
        found = list(self.unsupported)
        if found and not ignore_unsupported:
            if len(found) == 1:
                raise ValueError(f"{self.path}: with ignore_unsupported only: {found[0]}")
            heading = f"{self.path} has {len(found)} things that are not supported; with ignore_unsupported:"
            raise ValueError("\n  ".join([heading, *found]))
        for message in found:
            warn(f"{self.path}: {message}")

    def warn_notes(self) -> None:
        """Warn of each note."""
        for message in self.notes:
            warn(f"{self.path}: {message}")
