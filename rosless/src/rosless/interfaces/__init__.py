"""Message and service classes made from interface definitions.

:mod:`packages` finds the definitions, :mod:`definitions` parses them, :mod:`classes` makes classes of them,
:mod:`cdr` turns their objects into bytes and back, :mod:`idl` describes them to Cyclone DDS.
"""
