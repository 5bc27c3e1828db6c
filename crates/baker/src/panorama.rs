//! Lat-long panoramas and how radiance is read from them.
