"use strict";

/** The CRC-16 of CiA 301, 7.2.4.3.16: x^16 + x^12 + x^5 + 1, initial value 0, bit by bit; no other is asked for. */
function crc(bits, reflected, polynomial, polynomialHigh, initial, initialHigh, final, finalHigh, data) {
  if (bits !== 16 || reflected || polynomial !== 0x1021 || initial !== 0 || final !== 0)
    throw new RangeError("only the CRC of CiA 301 is here");
  let register = 0;
  for (const byte of data) {
    register ^= byte << 8;
    for (let bit = 0; bit < 8; bit += 1)
      register = ((register << 1) ^ (register & 0x8000 ? 0x1021 : 0)) & 0xffff;
  }
  return Buffer.from([register >> 8, register & 0xff]);
}

module.exports = { crc };
