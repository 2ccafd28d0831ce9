"""`python -m cadenza` is the command `cadenza`."""

from cadenza_command import main

main()
