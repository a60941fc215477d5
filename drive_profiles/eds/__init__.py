r"""Tolerant reading of device descriptions (EDS, DCF and XDD).

Every repair is reported with its line.

>>> from drive_profiles import eds
>>> description = eds.loads(
...     b"[MandatoryObjects]\nSupportedObjects=1\n1=0x1000\n"
...     b"[1000]\nParameterName=Device type\nDataType=7\nAccessType=ro\nDefaultValue=0x20192\nPDOMapping=0\nLowLimit=none\n"
... )
>>> hex(description.dictionary[0x1000].default)
'0x20192'
>>> [(warning.line, warning.key) for warning in description.warnings]
[(10, '[1000] LowLimit')]
"""

from drive_profiles.eds.description import Description, load, loads

__all__ = ["Description", "load", "loads"]
