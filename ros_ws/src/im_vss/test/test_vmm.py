"""Leases of Vision Modules: one at a time, first come first served, never lost."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from im_core import clock
from im_core.errors import NotFoundError, StateError, WaitTimeoutError
from im_vss.managers import VisionClient, VisionModuleManager
from im_vss.modules import VisionModule


class VmComputer(VisionModule):
    """Computes, as far as it is given a processor."""

    name = "vm_computer"
    computes = True


class VmCounter(VisionModule):
    """Counts how many are in it."""

    name = "vm_counter"

    def __init__(self):
        super().__init__(rig=None)
        self.inside = self.most = self.calls = 0

    def work(self, lease, seconds=0.001):
        def touch():
            self.inside += 1
            self.most = max(self.most, self.inside)
            clock.sleep(seconds)
            self.inside -= 1
            self.calls += 1
            return self.calls

        return self.run(lease, touch)


@pytest.fixture
def module():
    made = VmCounter()
    yield made
    made.close()


def manager(wait_s=60.0, hold_s=60.0):
    return VisionModuleManager("image_processing", {"vm_counter": hold_s}, wait_s)


def test_fifty_clients_never_two_inside(module):
    vmm = manager()

    def use(number):
        with vmm.lend("vm_counter", VisionClient(f"client {number}")) as lease:
            return module.work(lease)

    with ThreadPoolExecutor(50) as pool:
        results = list(pool.map(use, range(50)))
    assert sorted(results) == list(range(1, 51))
    assert module.most == 1
    assert (vmm.state("vm_counter").owner, vmm.state("vm_counter").queue) == ("", ())


def test_fifty_in_a_queue_of_whom_a_tenth_dies_are_served_in_the_order_they_came(module):
    vmm = manager()
    served, refused, alive = [], [], [True] * 50

    def use(number):
        client = VisionClient(str(number), alive=lambda: alive[number])
        try:
            with vmm.lend("vm_counter", client) as lease:
                module.work(lease, 0.0)
                served.append(number)
        except StateError:
            refused.append(number)

    threads = [threading.Thread(target=use, args=(number,)) for number in range(50)]
    with vmm.lend("vm_counter", VisionClient("first")):
        for number, thread in enumerate(threads):
            thread.start()
            while len(vmm.state("vm_counter").queue) <= number:
                clock.sleep(0.0005)
        for number in range(3, 50, 10):
            alive[number] = False
    for thread in threads:
        thread.join()
    assert sorted(refused) == list(range(3, 50, 10))
    assert served == [number for number in range(50) if number not in refused]
    state = vmm.state("vm_counter")
    assert (module.most, state.owner, state.queue) == (1, "", ())
    assert state.leases == state.released + state.lapsed


def test_first_come_first_served():
    vmm = manager()
    order, threads = [], []

    def use(number):
        with vmm.lend("vm_counter", VisionClient(str(number))):
            order.append(number)

    with vmm.lend("vm_counter", VisionClient("first")):
        for number in range(8):
            threads.append(threading.Thread(target=use, args=(number,)))
            threads[-1].start()
            while len(vmm.state("vm_counter").queue) <= number:
                clock.sleep(0.001)
        state = vmm.state("vm_counter")
        assert (state.owner, state.queue) == ("first", tuple(str(number) for number in range(8)))
    for thread in threads:
        thread.join()
    assert order == list(range(8))


def test_wait_is_bounded_and_names_the_holder():
    vmm = manager(wait_s=0.05)
    with (
        vmm.lend("vm_counter", VisionClient("spot_find #1")),
        pytest.raises(WaitTimeoutError, match=r"vm_counter, held by spot_find #1, 0 before snap #2"),
        vmm.lend("vm_counter", VisionClient("snap #2")),
    ):
        pass


def test_lease_ends_at_its_deadline(module):
    vmm = manager(hold_s=0.05)
    with vmm.lend("vm_counter", VisionClient("slow")) as old:
        with vmm.lend("vm_counter", VisionClient("next")) as lease:
            assert module.work(lease) == 1
        with pytest.raises(StateError, match="the lease of vm_counter by slow is over"):
            module.work(old)


def test_work_beyond_the_lease_is_a_timeout_and_blocks_nobody_forever(module):
    vmm = manager(hold_s=0.1)
    with pytest.raises(WaitTimeoutError), vmm.lend("vm_counter", VisionClient("stuck")) as lease:
        module.work(lease, seconds=0.15)
    with vmm.lend("vm_counter", VisionClient("next")) as lease:
        assert module.work(lease) == 2
    assert module.most == 1


def test_cancelled_and_dead_clients_lose_lease_and_place(module):
    vmm = manager()
    alive = True
    dying = VisionClient("dying", alive=lambda: alive)
    with vmm.lend("vm_counter", dying) as lost:
        alive = False
        with vmm.lend("vm_counter", VisionClient("heir")) as lease:
            assert module.work(lease) == 1
        with pytest.raises(StateError):
            module.work(lost)
    cancelled = VisionClient("cancelled")
    cancelled.cancel()
    with pytest.raises(StateError, match="cancelled gave up waiting"), vmm.lend("vm_counter", cancelled):
        pass


def test_other_modules_and_other_leases_are_refused(module):
    vmm = VisionModuleManager("both", {"vm_counter": 1.0, "vm_other": 1.0}, 1.0)
    with (
        pytest.raises(NotFoundError, match="'vm_countr'; did you mean 'vm_counter'"),
        vmm.lend("vm_countr", VisionClient("a")),
    ):
        pass
    with vmm.lend("vm_other", VisionClient("b")) as lease, pytest.raises(StateError, match="of vm_other, not of"):
        module.work(lease)


def test_a_lease_of_who_only_computes_lasts_while_no_processor_is_given(monkeypatch):
    module, vmm = VmComputer(rig=None), VisionModuleManager("computing", {"vm_computer": 0.2}, 60.0)
    monkeypatch.setattr("im_vss.modules.module.threads_queued_s", lambda pid: clock.monotonic())  # a busy computer
    with vmm.lend("vm_computer", VisionClient("late")) as lease:
        assert module.run(lease, lambda: clock.sleep(0.5)) is None
        assert lease.valid
    with vmm.lend("vm_computer", VisionClient("long")) as lease, pytest.raises(WaitTimeoutError, match="long"):
        module.run(lease, compute)
    assert vmm.state("vm_computer").lapsed == 1
    module.close()


def test_a_lease_of_who_computes_ends_though_his_thread_sleeps():
    """He waits for something else than a processor, and perhaps for ever: an import, a lock."""
    module, over = VmComputer(rig=None), threading.Event()
    vmm = VisionModuleManager("computing", {"vm_computer": 0.5}, 60.0)
    with vmm.lend("vm_computer", VisionClient("stuck")) as lease, pytest.raises(WaitTimeoutError, match="stuck"):
        module.run(lease, lambda: over.wait(30.0))
    over.set()
    module.close()


def compute():
    end = clock.thread_cpu() + 1.0
    while clock.thread_cpu() < end:
        pass
