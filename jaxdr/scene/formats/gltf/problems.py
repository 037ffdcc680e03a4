"""The parts of a glTF file that are not supported. They are collected, so that one error lists them all."""

import dataclasses
from pathlib import Path

from jaxdr.callers_line import warn


@dataclasses.dataclass
class Problems:
    """`unsupported`: things that are left out with `ignore_unsupported`, and are errors without. `notes`: warnings."""

    path: Path
    unsupported: list[str] = dataclasses.field(default_factory=list)
    notes: list[str] = dataclasses.field(default_factory=list)

    def leave_out(self, message: str) -> None:
        """Note, once, something that is not supported, and what happens instead."""
        if message not in self.unsupported:
            self.unsupported.append(message)

    def note(self, message: str) -> None:
        """Note, once, something that is read but does not look exactly as it should."""
        if message not in self.notes:
            self.notes.append(message)

    def check(self, ignore_unsupported: bool) -> None:
        """Raise one ValueError that lists what is not supported; with `ignore_unsupported` warn of each instead."""
        found = self.unsupported
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
