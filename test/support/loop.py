"""What a test does in the loop of a node that spins in another thread."""

from im_core import clock


def in_loop(node, call, *arguments, **options):
    """What a call returns that may happen nowhere else: what a node holds is its loop's."""
    task = node.executor.create_task(call, *arguments, **options)
    node.wake()
    deadline = clock.monotonic() + 60.0
    while not task.done():
        assert clock.monotonic() < deadline, f"{call} did not end"
        clock.sleep(0.002)
    return task.result()
