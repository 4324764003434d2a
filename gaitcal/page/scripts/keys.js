"use strict";
// The keyboard.
Gaitcal.Keys = class {
  constructor(page) {
    this.page = page;
  }
};
