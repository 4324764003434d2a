"use strict";
// Signs and units that the reader chooses.
