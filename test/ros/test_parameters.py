"""Declarations of parameters: what they admit, and what they say of what they do not."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from momrec_ros.parameters import NODE_PARAMETERS, Parameter

SOME = Parameter("size", 5, "How large.", 2, 9)
ANYTHING = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.lists(st.integers())
)
each = pytest.mark.parametrize("parameter", NODE_PARAMETERS, ids=lambda item: item.name)


def is_right(parameter, value):
    """Tell, type by type, what the declaration asks for."""
    if isinstance(parameter.default, bool) or isinstance(value, bool):
        return isinstance(parameter.default, bool) and isinstance(value, bool)
    if isinstance(parameter.default, str):
        return isinstance(value, str) and value in (parameter.choices or (value,))
    allowed = int | float if isinstance(parameter.default, float) else int
    return isinstance(value, allowed) and parameter.minimum <= value <= parameter.maximum


@each
@given(value=ANYTHING)
def test_a_value_is_admitted_where_type_and_range_or_choices_are_right(parameter, value):
    problem = parameter.problem_with(value)
    assert bool(problem) != is_right(parameter, value)
    if problem:
        assert problem.startswith(f"expected {parameter.name} as {parameter.type_name}")
        assert "\n" not in problem
        assert len(problem) < 300


@each
def test_the_default_the_ends_of_the_range_and_the_choices_are_admitted(parameter):
    values = [parameter.default, *parameter.choices]
    if parameter.minimum is not None:
        values += [parameter.minimum, parameter.maximum]
    assert [parameter.problem_with(value) for value in values] == [""] * len(values)


@each
def test_just_beyond_the_range_is_refused(parameter):
    if parameter.minimum is None:
        assert parameter.maximum is None
        return
    beyond = (
        (math.nextafter(parameter.minimum, -math.inf), math.nextafter(parameter.maximum, math.inf))
        if isinstance(parameter.default, float)
        else (parameter.minimum - 1, parameter.maximum + 1)
    )
    assert all(parameter.problem_with(value) for value in beyond)


def test_a_problem_says_what_was_expected_and_what_came():
    assert SOME.problem_with(12) == "expected size as integer (2 to 9), got 12"
    assert SOME.problem_with("big") == "expected size as integer (2 to 9), got 'big'"


def test_names_are_unique_and_descriptions_are_sentences():
    names = [parameter.name for parameter in NODE_PARAMETERS]
    assert len(set(names)) == len(names)
    for parameter in NODE_PARAMETERS:
        assert parameter.description[0].isupper()
        assert parameter.description.endswith(".")
