"""`python -m fibercontact` is the same as `fibercontact`."""

from fibercontact.cli import main

if __name__ == "__main__":
    main()
