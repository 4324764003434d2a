"use strict";
// The sheet of a result, back as numbers.
