"""Seeds for development and seeds for the test: ranges that cannot overlap."""

from dataclasses import dataclass

from flexx2_sim_ros.errors import InputError, shown


@dataclass(frozen=True)
class SeedRange:
    """A million seeds."""

    name: str
    block: int

    _SIZE = 1_000_000

    def seed(self, index: int) -> int:
        """
        Return a seed of the range.

        Raises InputError for an index outside 0 to 999,999.
        """
        if not 0 <= index < self._SIZE:
            raise InputError(f'seed index: must be 0 to {self._SIZE - 1}, got {index}')
        return self.block * self._SIZE + index

    def __contains__(self, seed: int) -> bool:
        """Return whether a seed is in this range."""
        return seed // self._SIZE == self.block


DEVELOPMENT = SeedRange('dev', 0)
# Each release uses the next million: the method was changed after the results of the last one.
# Taken: 1 (commits e3bc15f and f962f02), 2 (commit f07e407), 3 (commit 0a87d4e),
# 4 (commit d4a237e), 5 (commit 172e3a7), 6 (commit 9e88f99), 7 (commit b1bcdc1),
# 8 (commit e8c2acb), 9 (commit f0bad41), 10 (commit 0e39e16: 175 cases, lost before they were
# scored), 11 (commit 5bc8625), 12 (commit 67124f9), 13 (commit f181eb1), 14 (commit 7792e47: 92
# cases, stopped and not scored, because the method changed), 15 (commit 5ac565d), 16 (commit
# a6c8ed1), 17 (commit 307d2db).
TEST = SeedRange('test', 18)


def seed_range(name: str, release: bool) -> SeedRange:
    """
    Return a range by name; that of the test only for a release.

    Raises InputError for another name, or for the test seeds without ``--release``.
    """
    if name == DEVELOPMENT.name:
        return DEVELOPMENT
    if name != TEST.name:
        raise InputError(f'--seed-set: must be dev or test, got {shown(name)}')
    if not release:
        raise InputError(
            '--seed-set: must be dev, got test without --release. The test seeds are for the run '
            'of a release only: each further run makes the test less independent'
        )
    return TEST
