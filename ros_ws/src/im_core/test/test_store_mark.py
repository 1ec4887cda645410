"""An old copy of the object store is noticed, whatever overtakes what."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import DataError
from im_core.store_mark import SeenStore, StoreMark

OLD = "the object store of /dom is an old copy: its last transaction is 4, 9 was acknowledged before; what was changed"


def test_a_store_of_a_lower_number_or_another_identity_is_said_once():
    seen = SeenStore()
    assert seen.see(StoreMark("a", 9), None) == ""
    before = seen.mark
    assert seen.see(StoreMark("a", 4), before) == f"{OLD} since is lost"
    assert seen.see(StoreMark("a", 5), before) == ""  # asked before it was known
    assert seen.see(StoreMark("a", 6), seen.mark) == ""
    assert seen.see(StoreMark("b", 60), seen.mark).startswith("the object store of /dom is not the one that it was")
    assert seen.see(StoreMark("b", 60), seen.mark) == ""
    assert seen.mark == StoreMark("b", 60)


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=30))
def test_answers_that_overtake_each_other_are_no_loss(requests):
    """Each request has the number of the store when it is sent, and when it is answered; they arrive in any order."""
    seen, number = SeenStore(), 0
    sent = []
    for grown, waiting in requests:
        sent.append((waiting, seen.mark, StoreMark("a", number := number + grown)))
        for each in [each for each in sent if each[0] <= grown]:
            sent.remove(each)
            assert seen.see(each[2], each[1]) == ""
    highest = seen.mark
    for _, before, answered in sorted(sent, key=lambda each: each[0]):
        assert seen.see(answered, before) == ""
        assert highest is None or seen.mark.number >= highest.number


@pytest.mark.parametrize("text", ["", "a", "a:", ":1", "a:-1", "g:1", "a:1:1", f"a:{'9' * 19}", "a:1\n"])
def test_what_is_no_mark_is_refused_in_a_sentence(text):
    with pytest.raises(DataError, match=r"is no mark of an object store: IDENTITY:NUMBER"):
        StoreMark.of(text)


@given(st.integers(0, 10**18 - 1))
def test_a_mark_is_its_text(number):
    assert StoreMark.of(str(StoreMark("0f", number))) == StoreMark("0f", number)
