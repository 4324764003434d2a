"use strict";
// What is chosen: result, trial, preset, axis, units, signs; kept in the address.
