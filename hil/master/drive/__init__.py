"""One drive as the master sees it.

`axis` is a CiA 402 drive behind its node: identity, units, limits, gains and filters, and their way back. `needs` has the objects
that a run needs of it, `scale` reads how it counts, `overheard` knows it from what was heard, `mapping` has its process data, and
`pdo` writes them by the standard's procedure.
"""
