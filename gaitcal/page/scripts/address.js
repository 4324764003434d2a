"use strict";
// What is chosen, in the address.
Gaitcal.Address = class {
  constructor(page) {
    this.page = page;
  }
};
