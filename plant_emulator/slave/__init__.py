"""A CANopen slave engine without sockets, threads or clocks."""
