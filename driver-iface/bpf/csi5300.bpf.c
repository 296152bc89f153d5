/* SPDX-License-Identifier: MIT OR GPL-2.0 */
/*
 * Copies the parts of an Intel 5300's packets that csi5300 needs to a ring buffer, under an unmodified iwlwifi and iwldvm.
 *
 * A kprobe at the entry of
 *
 *     void iwl_notification_wait(struct iwl_notif_wait_data *notif_wait, struct iwl_rx_packet *pkt)
 *
 * which iwldvm calls first for every packet of its card. The packet's layout is the
 * firmware's ABI; the only kernel detail used is where x86-64 passes two arguments. BTF is neither needed nor made.
 *
 * driver_iface::stock::Event reads the events and documents their layout. Needs Linux 5.8 (ring buffer).
 * csi5300.bpf.o is built from this file; tests/checks/ebpf.sh builds it again and compares.
 */
typedef unsigned char u8;
typedef unsigned short u16;
typedef unsigned int u32;
typedef unsigned long long u64;

#define SEC(name) __attribute__((section(name), used))

/* include/uapi/linux/bpf.h: helpers and map types by number. */
static void *(*const map_lookup_elem)(void *map, const void *key) = (void *)1;
static u64 (*const ktime_get_ns)(void) = (void *)5;
static long (*const probe_read_kernel)(void *to, u32 len, const void *from) = (void *)113;
static long (*const ringbuf_output)(void *ring, void *bytes, u64 len, u64 flags) = (void *)130;
enum { MAP_ARRAY = 2, MAP_PERCPU_ARRAY = 6, MAP_RINGBUF = 27 };

struct map {
	u32 type, key_size, value_size, max_entries, flags;
};

/* arch/x86/include/asm/ptrace.h: struct pt_regs, of which rsi and rdi hold the second and first argument. */
struct registers {
	u64 r15, r14, r13, r12, bp, bx, r11, r10, r9, r8, ax, cx, dx, si, di;
};

/* struct iwl_rx_packet */
struct packet {
	u32 len_n_flags;
	u8 command, group;
	u16 sequence;
	u8 data[];
};
#define SIZE_MASK 0x3fff

enum { ALIVE = 0x01, CSI = 0xbb, RX_PHY = 0xc0, RX_MPDU = 0xc1 };
enum {
	PHY_KEPT = 64,          /* with the first configured word */
	CSI_KEPT = 20 + 552,    /* header, and the CSI of 3x3 chains */
	MPDU_FRAME = 4,         /* byte_count, reserved; then the frame */
	STATUS = 4,             /* after the frame */
	MIN_FRAME = 14,
	MAX_FRAME = 8191,
	MPDU_KEPT = MPDU_FRAME + 28, /* 802.11 header and number */
	WHOLE_KEPT = MPDU_FRAME + MAX_FRAME + STATUS,
	FLAG_FRAME_START = 1,
};

struct event {
	u64 card;
	u64 time_ns;
	u32 ring_full;
	u32 unreadable;
	u32 data_len;
	u8 command;
	u8 flags;
	u16 kept;
	u8 data[WHOLE_KEPT + 1]; /* 8200 */
};
#define EVENT_HEADER 32
_Static_assert(sizeof(struct event) == EVENT_HEADER + 8200, "no padding");

/* Since the program was loaded; user space reads them, and each event carries them so that a gap can be located. */
struct counts {
	u64 hits;       /* packets seen, of any command */
	u64 ring_full;
	u64 unreadable;
};

/* Its size is set before loading. */
struct map SEC("maps") EVENTS = { .type = MAP_RINGBUF, .max_entries = 1 << 20 };
struct map SEC("maps") COUNTS = { .type = MAP_ARRAY, .key_size = 4, .value_size = sizeof(struct counts), .max_entries = 1 };
struct map SEC("maps") SCRATCH = { .type = MAP_PERCPU_ARRAY, .key_size = 4, .value_size = sizeof(struct event), .max_entries = 1 };

/* Set before loading: keep whole frames instead of their beginning. */
const volatile u8 WHOLE_FRAMES SEC(".rodata") = 0;
/* Set before loading: size of the driver's receive buffers, which are aligned to it. No packet exceeds its buffer. */
const volatile u32 BUFFER SEC(".rodata") = 4096;

/* Hides a value from the compiler, so that a check of it stays and the kernel's verifier sees its bounds. */
#define OPAQUE(value) asm volatile("" : "+r"(value))

/* Offset of the frame's status in the data; 0 if the frame is impossible or longer than its packet. */
static inline u64 status_at(const struct event *event)
{
	u64 byte_count = event->data[0] | (u64)event->data[1] << 8;

	if (event->data_len < MPDU_FRAME || byte_count < MIN_FRAME || byte_count > MAX_FRAME ||
	    MPDU_FRAME + byte_count + STATUS > event->data_len)
		return 0;
	return MPDU_FRAME + byte_count;
}

/* The packet's first bytes. Returns their number, or -1 if the packet cannot be read. */
static inline long copy(struct event *event, const struct packet *packet, u64 data_len, u64 most)
{
	u64 kept = data_len < most ? data_len : most;

	OPAQUE(kept);
	if (kept > WHOLE_KEPT || (kept && probe_read_kernel(event->data, kept, packet->data)))
		return -1;
	return kept;
}

/* Fills in the data. Returns its length, or -1 if the packet cannot be read. */
static inline long fill(struct event *event, const struct packet *packet, u64 data_len)
{
	u64 status;

	if (event->command == ALIVE)
		return 0;
	if (event->command == RX_PHY)
		return copy(event, packet, data_len, PHY_KEPT);
	if (event->command == CSI)
		return copy(event, packet, data_len, CSI_KEPT);
	if (WHOLE_FRAMES)
		return copy(event, packet, data_len, WHOLE_KEPT);
	if (data_len < MPDU_KEPT)
		return copy(event, packet, data_len, MPDU_KEPT);
	if (probe_read_kernel(event->data, MPDU_KEPT, packet->data))
		return -1;
	status = status_at(event);
	if (!status)
		return MPDU_KEPT;
	if (probe_read_kernel(event->data + MPDU_KEPT, STATUS, packet->data + status))
		return -1;
	event->flags = FLAG_FRAME_START;
	return MPDU_KEPT + STATUS;
}

SEC("kprobe/iwl_notification_wait") int csi5300(struct registers *registers)
{
	const struct packet *packet = (const void *)registers->si;
	struct packet head;
	struct counts *counts;
	struct event *event;
	u32 zero = 0;
	u64 data_len, room;
	long kept;

	counts = map_lookup_elem(&COUNTS, &zero);
	if (!counts)
		return 0;
	__sync_fetch_and_add(&counts->hits, 1);
	room = BUFFER - ((u64)packet & (BUFFER - 1));
	if (room < sizeof(head) || probe_read_kernel(&head, sizeof(head), packet)) {
		__sync_fetch_and_add(&counts->unreadable, 1);
		return 0;
	}
	data_len = head.len_n_flags & SIZE_MASK;
	if (data_len < sizeof(head) - 4)
		return 0;
	data_len -= sizeof(head) - 4;
	if (data_len > room - sizeof(head))
		data_len = room - sizeof(head);
	if (head.command != CSI && head.command != RX_MPDU && head.command != RX_PHY && head.command != ALIVE)
		return 0;
	event = map_lookup_elem(&SCRATCH, &zero);
	if (!event)
		return 0;
	event->card = registers->di;
	event->time_ns = ktime_get_ns();
	event->ring_full = counts->ring_full;
	event->unreadable = counts->unreadable;
	event->data_len = data_len;
	event->command = head.command;
	event->flags = 0;
	kept = fill(event, packet, data_len);
	if (kept < 0) {
		__sync_fetch_and_add(&counts->unreadable, 1);
		return 0;
	}
	OPAQUE(kept);
	if (kept < 0 || kept > WHOLE_KEPT)
		return 0; /* cannot be */
	event->kept = kept;
	if (ringbuf_output(&EVENTS, event, EVENT_HEADER + kept, 0))
		__sync_fetch_and_add(&counts->ring_full, 1);
	return 0;
}

char LICENSE[] SEC("license") = "Dual MIT/GPL";
