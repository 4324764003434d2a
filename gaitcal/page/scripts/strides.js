"use strict";
// Curves over the gait cycle, and means over strides.
