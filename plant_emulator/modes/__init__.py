"""The modes of operation of CiA 402, one file per mode or family: what a drive does in Operation enabled."""
