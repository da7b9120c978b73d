"""The results of a long measurement, in a file that survives an interruption."""

import json
import lzma
from pathlib import Path

FOLDER = Path('build/torture')


class Journal:
    """
    Lines of JSON, each written as soon as its result is known.

    * `path`: the file. With the same settings it is continued, otherwise overwritten.
    * `settings`: the settings of the measurement, such as the seed; the first line has them
    """

    def __init__(self, path, **settings):
        """Read the existing entries."""
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        head = json.dumps(settings)
        text = path.read_text() if path.exists() else ''
        # A line that was interrupted has no newline.
        lines = text[: text.rfind('\n') + 1].splitlines()
        if lines[:1] != [head]:
            lines = [head]
        path.write_text(''.join(f'{line}\n' for line in lines))
        self._entries = [json.loads(line) for line in lines[1:]]

    def __iter__(self):
        """Iterate over the entries."""
        return iter(self._entries)

    def __len__(self):
        """Return the number of entries."""
        return len(self._entries)

    def add(self, entry):
        """Write an entry."""
        self._entries.append(entry)
        with self._path.open('a') as file:
            file.write(json.dumps(entry) + '\n')


def entries(path):
    """Return the entries of a file, whatever its settings are; it may be compressed (``.xz``)."""
    data = path.read_bytes()
    text = (lzma.decompress(data) if path.suffix == '.xz' else data).decode()
    return [json.loads(line) for line in text.splitlines()[1:]]
