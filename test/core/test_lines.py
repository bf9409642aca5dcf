"""Lines and directions in space, against exact arithmetic."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from momrec_core.lines import cross_products

VECTORS = st.tuples(*3 * [st.integers(-1000, 1000)])


@given(st.lists(st.tuples(VECTORS, VECTORS), min_size=1, max_size=5))
def test_cross_products_are_exact_for_integers(pairs):
    products = [(y * w - z * v, z * u - x * w, x * v - y * u) for (x, y, z), (u, v, w) in pairs]
    first, second = np.array(pairs, dtype=float).transpose(1, 0, 2)
    np.testing.assert_array_equal(cross_products(first, second), products)
    np.testing.assert_array_equal(cross_products(first[0], second[0]), products[0])
