// The handler of one kernel. All but its rows is done by `jaxdr_run`, which is compiled once and known by address.

static const Kernel KERNEL = {&body, READS, WRITES, SUMS, WIDTH, WHOLE};

extern "C" {
void* (*jaxdr_shared)(void* call, const Kernel* kernel) = nullptr;
void* jaxdr_handler(void* call) { return jaxdr_shared(call, &KERNEL); }
}
