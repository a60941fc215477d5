"""SDO servers of a node (CiA 301, 7.2.4).

>>> from plant_emulator.slave.dictionary import Dictionary
>>> from plant_emulator.slave.objects import communication_entries
>>> from plant_emulator.slave.sdo.server import SdoServer
>>> server = SdoServer(Dictionary(communication_entries(device_type=0x191, name="Sensor")))
>>> [answer.data.hex(" ") for answer in server.receive(bytes.fromhex("4000100000000000"), 0)]
['43 00 10 00 91 01 00 00']
"""
