"""`python -m cadenza` is the command `cadenza`."""

from cadenza_command import main

if __name__ == "__main__":  # and not where a process of the studio looks into it
    main()
