"use strict";
// How far the result can be believed.
