"""What all tests need before they start."""

import signal

# A shell that runs the tests in the background has them ignore Ctrl-C, and with them every process they start.
signal.signal(signal.SIGINT, signal.default_int_handler)
