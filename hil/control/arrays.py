"""Arrays by the kind of their numbers, of any shape."""

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Rows = NDArray[np.bool_]
"""Whether each row of a table is chosen, or each sample of a recording."""
