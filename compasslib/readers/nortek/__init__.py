"""Nortek's own formats: the older one of Aquadopp and AWAC (aqd, prf, wpr), and that of the Signature (ad2cp)."""
