"""Values of the parameter `effects` that are no file of effects, and a bound of memory."""

from contextlib import contextmanager
import os
import tracemalloc

MB = 1 << 20

HOSTILE_FILES = {
    'date': 'a: 2024-13-45',
    'number': 'a: 0x_',
    'digits': f'a: {"9" * 5000}',
    'large': f'effects: {{offset: {{bias: 0x{"f" * 5000}}}}}',
    'brackets': '[' * 3000,
    'maps': '{a: ' * 3000,
    'key': '? [1]\n: 2',
    'tag': 'a: !!bool x',
    'empty tag': 'a: !!int ""',
    'time': 'a: !!timestamp x',
    'surrogate': 'effects: {"\\ud800": 1}',
    'escape': 'effects: {"\\e[31m": 1}',
    'nul': '\0',
    'long': 'x' * 300_000,
    'names': f'effects: {{{"x" * 9000}: 1}}',
    'text': f'effects: {"x" * 9000}',
    'values': 'a: [' + '1, ' * 20_000 + ']',
    'aliases': 'a: &a [x, x, x, x, x, x, x, x]\n'
    + '\n'.join(
        f'{chr(98 + i)}: &{chr(98 + i)} [{", ".join(["*" + chr(97 + i)] * 9)}]' for i in range(9)
    ),
}


def hostile_texts(tmp_path):
    """Return values of `effects` that are no file of effects."""
    for name, text in HOSTILE_FILES.items():
        path = tmp_path / f'{name}.yaml'
        path.write_text(text if text[0] in '[{x\0' else f'schema: 1\n{text}\n')
        yield str(path)
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    yield from (
        str(pipe),
        '/dev/zero',
        '/dev/tty',
        str(tmp_path),
        'x' * 300,
        'x/' * 3000,
        'a\x1b[31mb',
        '~',
        '.',
        '..',
        '*',
        'x' * 100_000,
    )


@contextmanager
def little_memory(most=30 * MB):
    """Assert that the block allocates less than so many bytes at any time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()
