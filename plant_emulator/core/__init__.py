"""The emulator's core in C: plant and control period.

`CORE` has its functions and the layout of its records.

>>> from plant_emulator.core import CORE
>>> CORE.dtype("axis").names
('plant', 'plant_state', 'motion', 'law', 'change', 'past', 'encoder')
"""

from hil.core.library import Library
from plant_emulator.core.build import PLANT

CORE = Library(PLANT)
