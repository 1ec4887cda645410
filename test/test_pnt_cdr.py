"""Firings as bytes are what the middleware makes of their messages."""

from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message

from im_msgs.msg import Firing as FiringMessage
from im_pnt.execution.notification import Firing, Phase
from im_pnt_node.ros.cdr import encode_firing


@given(st.text(), st.text(), st.integers(0, 2**64 - 1), st.sampled_from(Phase), st.text(), st.text(), st.floats(0, 1e6))
def test_a_firing_is_what_the_middleware_makes_of_its_message(net, name, sequence, phase, symbol, message, duration):
    texts = [text.replace("\0", "") for text in (net, name, symbol, message)]
    net, name, symbol, message = texts
    firing = Firing(net, name, sequence, phase, symbol, 7, message, duration, -1.0)
    made = FiringMessage(
        stamp=Time(sec=3, nanosec=5),
        net=net,
        transition=name,
        sequence=sequence,
        phase=int(phase),
        symbol=symbol,
        command_id=7,
        message=message,
        duration=duration,
        progress=-1.0,
    )
    assert deserialize_message(encode_firing(firing, 3, 5), FiringMessage) == made
