"""A node that survives every service request, warns of misspelt parameters, and has no twin."""

from collections.abc import Callable
from contextlib import suppress
import socket
import sys
from traceback import format_exception
from typing import Any
from weakref import ref

from flexx2_sim_ros.errors import did_you_mean, InputError, shown, unquoted
from flexx2_sim_ros.nodes.parameters import as_declared, as_loaded
from flexx2_sim_ros.nodes.runtime import Throttle
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

_Answer = Callable[[Any, Any], Any]
_TYPES = {kind.value for kind in Parameter.Type}
_MOST_NAMES = 10
_MOST_ITEMS = 1000


class SteadyNode(Node):
    """
    A node whose services, including those of rclpy, answer every request.

    An error in a service callback is logged, and the request is refused. Parameters of one request
    are set together with `set_parameters_atomically`; if that is refused, each is set alone. First
    come those of ``set_first``, which others depend on. A read-only parameter may be set to its
    present value, so that a file of ``ros2 param dump`` can be loaded. A time of ``/clock`` before
    zero is ignored. It has its name alone on this machine (`claim_name`).
    """

    set_first: frozenset[str] = frozenset()

    def __init__(self, name: str, **options: Any) -> None:
        """Make the node with its parameter services."""
        self._service_errors = Throttle()
        super().__init__(name, **options)
        self._claim = claim_name(self)

    def destroy_node(self) -> None:
        """Close the node and release its name."""
        super().destroy_node()
        if (claim := getattr(self, '_claim', None)) is not None:
            claim.close()

    def create_service(
        self, srv_type: Any, srv_name: str, callback: _Answer, **options: Any
    ) -> Any:
        """Create a service like `rclpy.node.Node`; rclpy calls this for its own services too."""
        node = ref(self)  # As rclpy's own: a node that nobody else holds is free at once.

        def answer(request: Any, response: Any) -> Any:
            return node()._answer(srv_name, callback, request, response)  # type: ignore

        return super().create_service(srv_type, srv_name, answer, **options)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., None], *options: Any, **named: Any
    ) -> Any:
        """Create a subscription like `rclpy.node.Node`; the clock's never goes below zero."""
        if msg_type is not Clock:
            return super().create_subscription(msg_type, topic, callback, *options, **named)
        node = ref(self)

        def take(message: Clock) -> None:
            # rclpy raises an error for a time before zero.
            if message.clock.sec >= 0:
                callback(message)
            elif node()._service_errors.ready(topic):  # type: ignore
                node().get_logger().warning(  # type: ignore
                    f'{topic}: sec: must be 0 or more, got {message.clock.sec}; it is ignored'
                )

        return super().create_subscription(msg_type, topic, take, *options, **named)

    def _answer(self, service: str, callback: _Answer, request: Any, response: Any) -> Any:
        try:
            _check_length(request)
            if isinstance(request, SetParameters.Request):
                return self._set_parameters_service(request, response)
            if isinstance(request, SetParametersAtomically.Request):
                return self._set_atomically_service(request, response)
            return callback(request, response)
        except InputError as error:
            return _refusal(request, type(response)(), str(error))
        except Exception as error:  # A request must not end the node.
            if self._service_errors.ready(service):
                self.get_logger().error(
                    f'service {service}: internal error, please report it: '
                    f'{unquoted("".join(format_exception(error)), 4000)}'
                )
            return _refusal(request, type(response)(), f'internal error: {shown(error)}')

    def say_unknown_parameters(self) -> None:
        """Warn of parameters that were given at the start but do not exist."""
        unknown = [name for name in self._parameter_overrides if not self.has_parameter(name)]
        for name in unknown[:_MOST_NAMES]:
            self.get_logger().warning(f'parameter {self._no_such(name)}; it is ignored')
        if len(unknown) > _MOST_NAMES:
            self.get_logger().warning(
                f'{len(unknown) - _MOST_NAMES} more parameters that this node does not have are '
                'ignored'
            )

    def _no_such(self, name: str) -> str:
        hint = did_you_mean(name, self._parameters)
        return f'{unquoted(name)}: this node has no such parameter{hint}'

    def _set_parameters_service(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        results = [self._checked(message) for message in request.parameters]
        wanted = {
            index: Parameter.from_parameter_msg(request.parameters[index])
            for index, result in enumerate(results)
            if result is None
        }
        together = self._set_together(list(wanted.values()))
        for index in sorted(wanted, key=lambda i: wanted[i].name not in self.set_first):
            results[index] = (
                together
                if together.successful or len(wanted) == 1
                else self.set_parameters_atomically([wanted[index]])
            )
        response.results = results
        return response

    def _set_atomically_service(
        self, request: SetParametersAtomically.Request, response: SetParametersAtomically.Response
    ) -> SetParametersAtomically.Response:
        results = [self._checked(message) for message in request.parameters]
        refused = [result for result in results if result is not None and not result.successful]
        wanted = [
            Parameter.from_parameter_msg(message)
            for message, result in zip(request.parameters, results, strict=True)
            if result is None
        ]
        response.result = refused[0] if refused else self._set_together(wanted)
        return response

    def _set_together(self, parameters: list[Parameter]) -> SetParametersResult:
        if not parameters:
            return SetParametersResult(successful=True)
        names = [parameter.name for parameter in parameters]
        for name in set(names):
            if names.count(name) > 1:
                return _refused(f'{name}: must be given once, got it {names.count(name)} times')
        return self.set_parameters_atomically(parameters)

    def _checked(self, message: ParameterMessage) -> SetParametersResult | None:
        # None: it is to be set.
        if message.value.type not in _TYPES:
            return _refused(
                f'{unquoted(message.name)}: type: must be 0 to {max(_TYPES)}, got '
                f'{message.value.type}'
            )
        if not self.has_parameter(message.name):
            return _refused(self._no_such(message.name))
        now = self.get_parameter(message.name)
        given = Parameter.from_parameter_msg(message).value
        if self.describe_parameter(message.name).read_only:
            with suppress(InputError):
                if given == as_loaded(now.value):
                    return SetParametersResult(successful=True)
            if now.to_parameter_msg() != message:
                return _refused(
                    f'{message.name}: must be set at the start (read-only), got a change'
                )
            return SetParametersResult(successful=True)
        try:
            value = as_declared(message.name, given, now.value)
        except InputError as error:
            return _refused(str(error))
        if value is not given:
            message.value = Parameter(message.name, value=value).get_parameter_value()
        return None


def _check_length(request: Any) -> None:
    # A node has some hundred parameters; a request for a million would block it.
    for field in ('names', 'parameters', 'prefixes', 'levels'):
        length = len(getattr(request, field, ()))
        if length > _MOST_ITEMS:
            raise InputError(f'{field}: must be at most {_MOST_ITEMS}, got {length}')


def _refused(reason: str) -> SetParametersResult:
    return SetParametersResult(successful=False, reason=reason)


def _refusal(request: Any, response: Any, reason: str) -> Any:
    # The other services' responses say by being empty that there is nothing.
    if isinstance(response, SetParameters.Response):
        response.results = [_refused(reason) for _ in request.parameters]
    elif isinstance(response, SetParametersAtomically.Response):
        response.result = _refused(reason)
    elif hasattr(response, 'message'):
        response.message = reason
    return response


def twin_text(node: Node) -> str:
    """Return the error for a second node of a name: both would publish on the same topics."""
    return (
        f'node name: must be unique, got {node.get_fully_qualified_name()}, which is running '
        'already. Choose another name or namespace, e.g. --ros-args -r __node:=another'
    )


def take(node: Node, name: str) -> socket.socket | None:
    """
    Claim a name in the node's ROS domain for this process.

    The claim is an abstract socket name, which Linux releases when the process ends, even after a
    crash. On other systems nothing is claimed. The socket must be kept; closing it releases the
    name. Raises OSError when the name is claimed.
    """
    if sys.platform != 'linux':
        return None
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    whole = f'ros/{node.context.get_domain_id()}{name}'
    try:
        # At most 108 bytes: names differ at their end.
        claim.bind('\0' + whole[-100:])
    except OSError:
        claim.close()
        raise
    return claim


def claim_name(node: Node) -> socket.socket | None:
    """
    Claim a node's name on this machine: in the graph, a second node appears only after 3 s.

    The socket must be kept while the node runs. Raises InputError when another process has claimed
    it.
    """
    try:
        return take(node, node.get_fully_qualified_name())
    except OSError as error:
        raise InputError(twin_text(node)) from error
