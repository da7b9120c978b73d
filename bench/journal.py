"""What a long measurement has found so far, in a file that outlives it."""

from collections.abc import Iterator
import json
from pathlib import Path
from typing import Any

FOLDER = Path('build/torture')


class Journal:
    """
    Lines of JSON, each written as soon as it is known.

    Parameters
    ----------
    path : Path
        The file. One of the same settings is gone on with; any other is begun anew.
    settings
        What the lines depend on, e.g. the seed; the first line holds them.

    """

    def __init__(self, path: Path, **settings: Any) -> None:
        """Read what is there."""
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        head = json.dumps(settings)
        text = path.read_text() if path.exists() else ''
        # A line that was being written when the run ended has no end.
        lines = text[: text.rfind('\n') + 1].splitlines()
        if lines[:1] != [head]:
            lines = [head]
        path.write_text(''.join(f'{line}\n' for line in lines))
        self._entries = [json.loads(line) for line in lines[1:]]

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Iterate over the entries."""
        return iter(self._entries)

    def __len__(self) -> int:
        """Return how many entries there are."""
        return len(self._entries)

    def add(self, entry: dict[str, Any]) -> None:
        """Write an entry."""
        self._entries.append(entry)
        with self._path.open('a') as file:
            file.write(json.dumps(entry) + '\n')
