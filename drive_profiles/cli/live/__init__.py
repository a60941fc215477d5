"""Commands on a bus that is alive: what nodes say now, what is wrong, and services of CiA 301 and 305 on whole nodes."""
