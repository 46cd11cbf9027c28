"""Parts that several commands use: tables, progress bars, safe terminal output, and the processes of the live page and of the simulator."""
