"""What a subscription asks for, and what it counts as lost."""

import unittest

try:
    import rclpy  # noqa: F401
except ImportError as error:
    raise unittest.SkipTest('ROS 2 is not installed: rclpy cannot be imported') from error

from flexx2_sim_ros.nodes.subscriptions import LossCounter, matching
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
LATCHED, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE


@pytest.mark.parametrize(
    ('offers', 'expected'),
    [
        ([], (RELIABLE, VOLATILE)),
        ([(RELIABLE, VOLATILE)], (RELIABLE, VOLATILE)),
        ([(BEST_EFFORT, VOLATILE)], (BEST_EFFORT, VOLATILE)),
        ([(RELIABLE, LATCHED)], (RELIABLE, LATCHED)),
        ([(RELIABLE, LATCHED), (BEST_EFFORT, VOLATILE)], (BEST_EFFORT, VOLATILE)),
        ([(RELIABLE, LATCHED), (RELIABLE, VOLATILE)], (RELIABLE, VOLATILE)),
    ],
    ids=str,
)
def test_the_subscription_uses_the_best_quality_that_all_publishers_offer(offers, expected):
    assert (
        matching(
            [
                QoSProfile(depth=1, reliability=reliability, durability=durability)
                for reliability, durability in offers
            ]
        )
        == expected
    )


@pytest.mark.parametrize(
    ('numbers', 'lost'),
    [
        ([5, 6, 7], 0),
        ([5, 7, 10], 3),
        ([9, 1, 2], 0),
        ([3, 3, 4], 0),
        ([None, None], 0),
        ([1, None, 9], 0),
        ([5, 6, 9, 1, 2, None, 7], 2),
    ],
    ids=str,
)
def test_lost_messages_are_counted(numbers, lost):
    counter = LossCounter()
    for number in numbers:
        counter.count(number, lambda: True)
    assert counter.lost == lost


def test_losses_of_several_publishers_are_not_counted():
    counter = LossCounter()
    for number in (1, 50, 2, 51):
        counter.count(number, lambda: False)
    assert counter.lost == 0
