"""Writers that export logs of any origin to formats of other programs."""
