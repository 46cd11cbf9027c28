"""TESCAN SharkSEM: remote control of TESCAN microscopes over TCP.

Source of every command and field: "SharkSEM Remote Control", revision 2.0.22 (TESCAN, 2015), and the reference of the C# library
"SharkSEM 3.2.20", both as published in `Hplentz/SharkSEM-Test-D`; the public clients in `delmic/odemis` (`driver/tescan.py`) and TESCAN's
own Python client 2.0.16 agree with them. Not tried at a microscope.
"""
