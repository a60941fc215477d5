"""The core in C: built by `build`, loaded by `library`; each header describes the records that Python and C share."""
