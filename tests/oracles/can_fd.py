"""A second implementation of a CAN FD sender, bit by bit: what frames are counted against."""


def sent_by_fd(can_id, data, is_extended=False):
    """A CAN FD sender, bit by bit: (bit, whether in the data phase)."""
    dlc = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64].index(len(data))
    name = f"{can_id:029b}" if is_extended else f"{can_id:011b}"
    slow = "0" + (name[:11] + "11" + name[11:] + "0" if is_extended else name + "00") + "101"
    sent, run, count = [], 0, 0
    payload = "0" + f"{dlc:04b}" + "".join(f"{byte:08b}" for byte in data)
    for position, bit in enumerate(slow + payload):
        if run == 5:  # before the next bit of the contents; so none follows the last
            sent.append(("1" if sent[-1][0] == "0" else "0", position >= len(slow)))
            run, count = 1, count + 1
        run = run + 1 if sent and sent[-1][0] == bit else 1
        sent.append((bit, position >= len(slow)))
    sbc = {0: "0000", 1: "0011", 2: "0110", 3: "0101", 4: "1100", 5: "1111", 6: "1010", 7: "1001"}[count % 8]
    width = 17 if len(data) <= 16 else 21
    checked = sbc + crc_of("".join(bit for bit, _ in sent) + sbc, width, {width - 1})
    for position, bit in enumerate(checked):
        if position % 4 == 0:
            sent.append(("1" if sent[-1][0] == "0" else "0", True))
        sent.append((bit, True))
    return sent


TAPS = {17: (16, 14, 13, 11, 6, 4, 3, 1, 0), 21: (20, 13, 11, 7, 4, 3, 0)}


def crc_of(bits, width, register):
    """The CRC of bits as text; of the register the exponents that are set."""
    for bit in bits:
        carry = (width - 1 in register) != (bit == "1")
        register = {exponent + 1 for exponent in register if exponent + 1 < width}
        register ^= set(TAPS[width]) if carry else set()
    return "".join("1" if exponent in register else "0" for exponent in reversed(range(width)))


def counted_fd(can_id, data, is_extended=False):
    """Bits at the slow and at the fast rate, with the intermission."""
    sent = sent_by_fd(can_id, data, is_extended)
    fast = sum(phase for _, phase in sent) + 1
    return len(sent) + 13 - fast, fast
