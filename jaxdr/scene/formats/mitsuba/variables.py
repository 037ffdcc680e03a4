"""`$variables` of Mitsuba scene files."""

import re

from jaxdr.scene.formats.mitsuba.element import Element

LONGEST_NAME = 200
MOST_CHARACTERS = 1 << 22  # that variables may add to the text of a scene


class Variables:
    """Values of `$name`: those that the caller gave, and the `<default>`s read so far, which don't override those.

    Values of values double with every `<default>`, so all characters that are put in are counted.
    """

    def __init__(self, given: dict[str, object]):
        self.values = {name: str(v).lower() if isinstance(v, bool) else str(v) for name, v in given.items()}
        self.unknown = set(given)  # given, but met neither as $name nor in a <default>
        self._characters = 0

    def declare(self, name: str, value: str) -> None:
        """Take the value of a `<default>`, unless the variable has one already."""
        self.values.setdefault(name, value)
        self.unknown.discard(name)

    def substitute(self, text: str, element: Element) -> str:
        """`text` with every `$name` replaced. The longest known name counts, as in Mitsuba."""

        def value(match: re.Match) -> str:
            word = match[1]
            name = next((word[:n] for n in range(min(len(word), LONGEST_NAME), 0, -1) if word[:n] in self.values), None)
            if name is None:
                word = word if len(word) <= LONGEST_NAME else f"{word[:LONGEST_NAME]}…"
                raise element.error(
                    f"variable ${word} has no value; give it as a keyword ({word}=...) or by a <default>"
                )
            self.unknown.discard(name)
            self._characters += len(self.values[name])
            if self._characters > MOST_CHARACTERS:
                raise element.error(f"variables add more than {MOST_CHARACTERS} characters to the scene")
            return self.values[name] + word[len(name) :]

        return re.sub(r"\$(\w*)", value, text)
