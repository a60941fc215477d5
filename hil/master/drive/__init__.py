"""One drive on the bus, for the master.

`axis` is a CiA 402 drive and its node: identity, units, limits, gains and filters, and their restoration. `needs` has the objects
that a run needs of it, `scale` reads its units or takes them from overheard frames, `mapping` has its process data, and
`pdo` writes the PDOs by the standard's procedure.
"""
