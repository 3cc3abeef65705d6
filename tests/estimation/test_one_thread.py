"""Matrix products run on one thread where requested, and on all threads afterwards."""

from __future__ import annotations

import pytest
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits

from truing.estimation.one_thread import on_one_thread


def threads():
    assert scipy.linalg is not None  # its library is loaded too
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def test_one_thread_inside_and_as_many_as_before_afterwards():
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        assert set(on_one_thread(threads)()) == {1}
        assert threads() == before


def test_a_fault_inside_leaves_as_many_as_before():
    @on_one_thread
    def fails():
        raise ValueError("told")

    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        with pytest.raises(ValueError, match="told"):
            fails()
        assert threads() == before
