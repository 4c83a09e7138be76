"""Runtime control: a daemon that is changed, stopped and started while its loop runs.

Another process serves the control socket, checks what is asked for and prepares it (`server`, `prepare`). What the loop
needs of it comes through shared memory (`journal`), as plain numbers (`packed`), and the loop applies it between two
cycles (`changes`). README.md of this folder explains socket, protocol and guarantees.
"""
