"""The MIP protocol of MicroStrain sensors: packets and fields."""
