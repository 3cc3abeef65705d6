"""A PTB digital calibration certificate (DCC 3.3.0, D-SI 2.2.1) of the results that qualify for one."""
