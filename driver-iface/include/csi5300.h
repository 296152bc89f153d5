/* SPDX-License-Identifier: MIT OR Apache-2.0 */
/*
 * The bytes between the Intel 5300, its kernel driver, its log files and csi5300, for C.
 *
 * The same contract as the Rust crate driver-iface; its tests compare every constant in this file with Rust's,
 * or with Linux's where only C needs it.
 * All fields are little-endian unless noted otherwise. Tables: ../README.md.
 */
#ifndef CSI5300_H
#define CSI5300_H

/* Kernel connector: nlmsghdr, cn_msg, then code and body. */
#define CSI5300_AF_NETLINK 16
#define CSI5300_NETLINK_CONNECTOR 11
#define CSI5300_SOL_NETLINK 270
#define CSI5300_NETLINK_ADD_MEMBERSHIP 1
#define CSI5300_NETLINK_NO_ENOBUFS 5
#define CSI5300_NLMSG_DONE 3
#define CSI5300_NLMSGHDR 16
#define CSI5300_CN_MSG 20
#define CSI5300_HEADERS 36
#define CSI5300_MAX_DATAGRAM 65572
#define CSI5300_CN_IDX 26            /* 11 connector users: kernels from about 3.10 on */
#define CSI5300_CN_IDX_10_USERS 25   /* about 2.6.39 to 3.9 */
#define CSI5300_CN_IDX_8_USERS 23    /* about 2.6.32 to 2.6.38 */
#define CSI5300_CN_IDX_EARLY 254     /* the earliest csitool trees */
#define CSI5300_CN_VAL 1
#define CSI5300_CN_NAME "iwlagn"     /* in /proc/net/connector */

/* Offsets in a datagram. */
#define CSI5300_OFF_NLMSG_LEN 0      /* u32, without padding */
#define CSI5300_OFF_NLMSG_TYPE 4     /* u16 */
#define CSI5300_OFF_NLMSG_FLAGS 6    /* u16 */
#define CSI5300_OFF_NLMSG_SEQ 8      /* u32 */
#define CSI5300_OFF_NLMSG_PID 12     /* u32 */
#define CSI5300_OFF_CN_IDX 16        /* u32 */
#define CSI5300_OFF_CN_VAL 20        /* u32 */
#define CSI5300_OFF_CN_SEQ 24        /* u32 */
#define CSI5300_OFF_CN_ACK 28        /* u32, leftovers */
#define CSI5300_OFF_CN_LEN 32        /* u16, bytes of data */
#define CSI5300_OFF_CN_FLAGS 34      /* u16, leftovers */
#define CSI5300_OFF_DATA 36          /* code, body */

/* .dat log: u16 BIG-endian length, then that many bytes: code and body. */
#define CSI5300_LENGTH_FIELD 2
#define CSI5300_MAX_LENGTH 8192

/* Message codes. */
#define CSI5300_CODE_BFEE 0xBB
#define CSI5300_CODE_RX_PHY 0xC0
#define CSI5300_CODE_MPDU 0xC1
#define CSI5300_CODE_RX 0xC3
#define CSI5300_CODE_NOISE 0xD0
#define CSI5300_CODE_TX_RESP 0x1C
#define CSI5300_CODE_TX_BLOCK_AGG 0xC5
#define CSI5300_CODE_STATUS 0xD1
#define CSI5300_CODE_PARALLEL 0xD2
#define CSI5300_CODE_CARD_CLOCK 0xCC /* of translated logs of other cards */
#define CSI5300_CODE_LEFT_OUT 0xCD

/* Body of 0xBB, stock layout; WSR puts 18 bytes between header and CSI. */
#define CSI5300_SUBCARRIERS 30
#define CSI5300_STOCK_HEADER 20
#define CSI5300_WSR_EXTRA 18
#define CSI5300_WSR_2021_EXTRA 14 /* without the number */
#define CSI5300_WSR_2021_HEADER 34
#define CSI5300_WSR_HEADER 38
#define CSI5300_MAX_BODY 590
#define CSI5300_NOISE_UNKNOWN_DBM (-127)
#define CSI5300_CSI_LEN(n_rx, n_tx) (60 * (n_rx) * (n_tx) + 12)
#define CSI5300_BFEE_TIMESTAMP_LOW 0 /* u32, microseconds */
#define CSI5300_BFEE_BFEE_COUNT 4    /* u16 */
#define CSI5300_BFEE_RESERVED 6      /* u16 */
#define CSI5300_BFEE_N_RX 8          /* u8 */
#define CSI5300_BFEE_N_TX 9          /* u8 */
#define CSI5300_BFEE_RSSI 10         /* u8 each for A, B, C */
#define CSI5300_BFEE_NOISE 13        /* i8, dBm */
#define CSI5300_BFEE_AGC 14          /* u8, dB */
#define CSI5300_BFEE_ANTENNA_SEL 15  /* u8, three 2-bit numbers */
#define CSI5300_BFEE_LEN 16          /* u16, bytes of CSI */
#define CSI5300_BFEE_RATE_N_FLAGS 18 /* u16 */
#define CSI5300_BFEE_TV_SEC 20       /* u32, WSR */
#define CSI5300_BFEE_TV_USEC 24      /* u32, WSR */
#define CSI5300_BFEE_MAC 28          /* 6 bytes, WSR */
#define CSI5300_BFEE_FRAME_COUNT 34  /* u32, WSR */

/* Bits of rate_n_flags. */
#define CSI5300_RATE_HT 0x0100
#define CSI5300_RATE_CCK 0x0200
#define CSI5300_RATE_GREENFIELD 0x0400
#define CSI5300_RATE_HT40 0x0800
#define CSI5300_RATE_DUPLICATE 0x1000
#define CSI5300_RATE_SHORT_GI 0x2000

/* Body of 0xC1: 802.11 header, payload, FCS. */
#define CSI5300_MPDU_HEADER 24
#define CSI5300_MPDU_FCS 4
#define CSI5300_MPDU_FRAME_CONTROL 0 /* u16 */
#define CSI5300_MPDU_DURATION 2      /* u16, microseconds */
#define CSI5300_MPDU_ADDR1 4
#define CSI5300_MPDU_ADDR2 10
#define CSI5300_MPDU_ADDR3 16
#define CSI5300_MPDU_SEQ_CTRL 22     /* u16 */
#define CSI5300_MPDU_COUNTER 24      /* u32, BIG-endian */

/* Sounding frames, as injected: 802.11 header, number and the rest of the payload, after a radiotap header. */
#define CSI5300_SOUNDING_HEADER_LEN 24
#define CSI5300_SOUNDING_FCS_LEN 4
#define CSI5300_SOUNDING_MIN_LEN 28
#define CSI5300_SOUNDING_DEFAULT_LEN 57 /* WSR: bytes on air, FCS included; robot k adds 2 k */
#define CSI5300_SOUNDING_REPLY_GROWTH 5 /* WSR: an answer is this much longer */
#define CSI5300_SOUNDING_MAGIC_MAC "\x00\x16\xea\x12\x34\x56" /* addresses 1 and 2 */
#define CSI5300_RADIOTAP_MIN_LEN 8
#define CSI5300_RADIOTAP_FLAGS_FCS 0x10
#define CSI5300_RADIOTAP_FLAGS_DATAPAD 0x20
#define CSI5300_RADIOTAP_FLAGS_BAD_FCS 0x40
#define CSI5300_RADIOTAP_TX_FLAGS_NO_ACK 0x0008

#endif
