"""The load frame and the stage: dynamics and Modbus server."""
