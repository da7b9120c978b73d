"""The executor of nodes, on rclpy itself: what it waits for may change while it spins."""

from flexx2_sim_ros.nodes.executor import MessageExecutor
import pytest
import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String
from std_srvs.srv import Trigger


@pytest.fixture
def node():
    """Return a node in a context of its own, with its executor in `made`."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    one = rclpy.create_node('one', context=context)
    one.made = MessageExecutor(context=context)
    one.made.add_node(one)
    yield one
    one.made.shutdown()
    one.destroy_node()
    rclpy.try_shutdown(context=context)


def spin_until(node, done):
    """Spin a node, at most 200 times, until ``done()``; return whether it is."""
    for _ in range(200):
        if done():
            break
        node.made.spin_once(timeout_sec=0.05)
    return bool(done())


def test_a_subscription_a_timer_and_a_service_come_and_go_while_it_spins(node):
    heard, ticks = [], []
    publisher = node.create_publisher(String, 'words', 10)
    for word in ('first', 'second'):
        subscription = node.create_subscription(
            String, 'words', lambda message: heard.append(message.data), 10
        )
        timer = node.create_timer(0.01, lambda: ticks.append(1))
        service = node.create_service(Trigger, 'ask', lambda _, answer: answer)
        client = node.create_client(Trigger, 'ask')
        assert spin_until(
            node, lambda c=client: publisher.get_subscription_count() and c.service_is_ready()
        )
        publisher.publish(String(data=word))
        future = client.call_async(Trigger.Request())
        assert spin_until(node, lambda w=word, f=future: w in heard and ticks and f.done())
        node.destroy_client(client)
        node.destroy_service(service)
        node.destroy_timer(timer)
        node.destroy_subscription(subscription)
        node.made.spin_once(timeout_sec=0.0)
        ticks.clear()
        node.made.spin_once(timeout_sec=0.05)
        assert not ticks
    assert heard == ['first', 'second']


def test_it_waits_as_long_as_it_is_told(node, monkeypatch):
    waits = []
    monkeypatch.setattr(node.made, '_wait', waits.append)
    for seconds in (0.05, None):
        node.made.spin_once(seconds)
    assert waits == [50_000_000, -1]  # nanoseconds; -1: for ever


def test_an_error_of_a_callback_reaches_the_caller_and_it_spins_on(node):
    calls = []

    def fail():
        calls.append(1)
        raise ValueError('of a callback')

    node.create_timer(0.01, fail)
    for count in (1, 2):
        with pytest.raises(ValueError, match='of a callback'):
            spin_until(node, lambda: False)
        assert len(calls) == count


def test_a_shutdown_ends_it(node):
    node.create_timer(0.01, lambda: rclpy.shutdown(context=node.context))
    with pytest.raises(ExternalShutdownException):
        spin_until(node, lambda: False)
