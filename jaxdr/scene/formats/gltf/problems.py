"""What a glTF file has that a scene here can't hold: collected, so that one error lists it all."""

import dataclasses
from pathlib import Path

from jaxdr.callers_line import warn


@dataclasses.dataclass
class Problems:
    """`unsupported` things are left out, which needs `ignore_unsupported`; `notes` are warnings in any case."""

    path: Path
    unsupported: list[str] = dataclasses.field(default_factory=list)
    notes: list[str] = dataclasses.field(default_factory=list)

    def leave_out(self, message: str) -> None:
        """Note once what is not supported, and what happens instead."""
        if message not in self.unsupported:
            self.unsupported.append(message)

    def note(self, message: str) -> None:
        """Note once what is read, but not to the letter."""
        if message not in self.notes:
            self.notes.append(message)

    def check(self, ignore_unsupported: bool) -> None:
        """Raise one ValueError that lists what is not supported, or warn of each."""
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
