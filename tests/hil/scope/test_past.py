"""A viewer who comes late gets the last seconds, whole; one who is slow gets what is still there."""

import numpy as np

from hil.scope.past import Past


def rows(first, count, width=2, period_s=0.001):
    time_s = (first + np.arange(count)) * period_s
    return time_s, np.column_stack([first + np.arange(count) + 1000.0 * column for column in range(width)])


def test_rows_come_back_as_they_went_in_from_any_number_on():
    past = Past()
    for first in range(0, 1000, 50):
        past.add(*rows(first, 50))
    for begin in (0, 1, 49, 50, 777, 999, 1000):
        first, time_s, values = past.since(begin)
        assert first == begin
        np.testing.assert_array_equal(values[:, 0], np.arange(begin, 1000))
        np.testing.assert_allclose(time_s, np.arange(begin, 1000) * 0.001)


def test_what_is_older_than_ten_seconds_is_forgotten_and_counted():
    past = Past()
    for first in range(0, 25_000, 50):
        past.add(*rows(first, 50))
    first, time_s, values = past.since(0)
    assert past.end == 25_000
    assert 10.0 <= time_s[-1] - time_s[0] <= 10.06
    assert first == past.first == values[0, 0]
    np.testing.assert_array_equal(values[:, 0], np.arange(first, 25_000))


def test_a_signal_that_comes_later_was_not_there_before():
    past = Past()
    past.add(*rows(0, 10, width=1))
    past.add(*rows(10, 10, width=3))
    _, _, values = past.since(5)
    assert values.shape == (15, 3)
    assert np.isnan(values[:5, 1:]).all()
    assert not np.isnan(values[5:]).any()


def test_a_clock_that_begins_anew_begins_the_past_anew():
    past = Past()
    past.add(*rows(5000, 10))
    past.add(*rows(0, 10))
    first, time_s, _ = past.since(0)
    assert first == 10
    assert time_s[0] == 0.0
