"""Read a file, as of a profile, field by field; refuse what cannot be used by file and field."""

import math
import re
from typing import Any

from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.profiles.sensor import MOST_CORNERS

_EXPONENT = re.compile(r'[-+]?\d+\.?\d*[eE][-+]?\d+')


class Section:
    """A mapping in the file, its fields read one by one; `label` names file and field."""

    def __init__(
        self,
        file: str,
        name: str,
        content: Any,
        fields: tuple[str, ...] | None,
        optional: tuple[str, ...] = (),
    ) -> None:
        self._file, self._name, self._content = file, name, content
        if not isinstance(content, dict):
            raise InputError(f'{self.label}: must be a mapping of fields, got {shown(content)}')
        if fields is None:
            return
        missing = [name for name in fields if name not in content]
        if missing:
            more = f' (and also {", ".join(missing[1:])})' if missing[1:] else ''
            raise InputError(
                f'{self._of(missing[0])}{more}: must be in the file, got a file without'
            )
        for extra in content:
            if extra not in (*fields, *optional):
                raise InputError(
                    f'{self._of(extra)}: must be one of {", ".join((*fields, *optional))}, got an '
                    'unknown field'
                )

    @property
    def label(self) -> str:
        return f'{self._file}{self._name or "the file"}'

    def _of(self, name: Any) -> str:
        return f'{self._file}{self._name}{"." if self._name else ""}{unquoted(name)}'

    def wrong(self, name: str, required: str) -> InputError:
        value = self._content[name]
        return InputError(
            f'{self._of(name)}: must be {required}, got {shown(value)}{_hint_on_exponents(value)}'
        )

    def has(self, name: str) -> bool:
        return name in self._content

    def is_null(self, name: str) -> bool:
        return self._content[name] is None

    def section(
        self, name: str, fields: tuple[str, ...] | None, optional: tuple[str, ...] = ()
    ) -> 'Section':
        inner = f'{self._name}.{name}' if self._name else name
        return Section(self._file, inner, self._content[name], fields, optional)

    def mapping(self, name: str) -> dict[str, Any]:
        if not isinstance(self._content[name], dict):
            raise self.wrong(name, 'a mapping')
        return dict(self._content[name])

    def text(self, name: str) -> str:
        value = self._content[name]
        if not (isinstance(value, str) and value.strip() and value.isprintable()):
            raise self.wrong(name, 'a text')
        return value

    def one_of(self, name: str, choices: tuple[str, ...]) -> str:
        value = self._content[name]
        if not isinstance(value, str) or value not in choices:
            raise self.wrong(name, f'one of {", ".join(choices)}')
        return value

    def corners(self, name: str, largest: float) -> list[list[float]]:
        value = self._content[name]
        if value is None:
            return []
        if not (
            isinstance(value, list)
            and 3 <= len(value) <= MOST_CORNERS
            and all(
                isinstance(corner, list)
                and len(corner) == 2
                and all(is_number(at) and abs(at) <= largest for at in corner)
                for corner in value
            )
        ):
            raise self.wrong(name, f'3 to {MOST_CORNERS} corners [column, row] in pixels, or null')
        return value

    def number(self, name: str, low: float, high: float) -> float:
        value = self._content[name]
        if not (is_number(value) and low <= value <= high):
            raise self.wrong(name, f'a number from {low:g} to {high:g}')
        return float(value)

    def whole(self, name: str, low: int, high: float, optional: bool = False) -> int:
        value = self._content[name]
        if optional and value is None:
            return 0
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.wrong(name, f'a whole number from {low} to {high:g}')
        return value

    def numbers(
        self, name: str, lengths: tuple[int, ...], low: float, high: float, optional: bool = False
    ) -> list[float]:
        value = self._content[name]
        if optional and value is None:
            return []
        if not (
            isinstance(value, list)
            and len(value) in lengths
            and all(is_number(item) and low <= item <= high for item in value)
        ):
            raise self.wrong(
                name,
                f'a list of {" or ".join(map(str, lengths))} numbers from {low:g} to {high:g}',
            )
        return [float(item) for item in value]

    def errors(self) -> dict[str, float | None]:
        for name, value in self._content.items():
            if value is not None and not (is_number(value) and value >= 0):
                raise self.wrong(name, 'a number that is not negative, or null')
        return dict(self._content)


def is_number(value: Any) -> bool:
    """Say whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf


def _hint_on_exponents(value: Any) -> str:
    # YAML 1.1 reads a number as text if it has an exponent without a point or without a sign.
    for item in value if isinstance(value, list) else [value]:
        if isinstance(item, str) and _EXPONENT.fullmatch(item) and len(item) < 20:
            return f'. YAML takes {item} for a text; write {float(item)}'
    return ''
