// Reads .gdibl irradiance volumes in a page or in Node, by the module gdibl_runtime_c.wasm beside this file. To build it:
//
//   rustup target add wasm32-unknown-unknown
//   cargo rustc -p gdibl-runtime-c --lib --crate-type cdylib --target wasm32-unknown-unknown --profile wasm \
//     --no-default-features
//   cp target/wasm32-unknown-unknown/wasm/gdibl_runtime_c.wasm integrations/web/
//
//   const gdibl = await loadGdibl();
//   const volume = gdibl.parse( new Uint8Array( await ( await fetch( 'level.gdibl' ) ).arrayBuffer() ) );
//   const [ r, g, b ] = volume.irradiance( [ 1, 1.5, - 2 ], [ 0, 1, 0 ] );
//   volume.free();
//
// Metres, glTF's axes, unit normals. Irradiance E is what falls on a surface, in linear Rec.709: diffuse = albedo / π · E.
// Coefficients of crates/runtime-c/include/gdibl.h, which says more. A file compressed with zstd needs a module that was
// built with `--features zstd`; one built with `--features messages` also says what was found and what was expected where a
// file is damaged, one built with `--features fast` answers queries faster.

const KINDS = [ 'grid', 'points', 'vertices', 'sparse' ];
const MESSAGE_BYTES = 512;
const FLOAT = 4, POINTER = 4, HEADER_BYTES = 72;

/** Loads the module from its bytes, or from the file of its name beside this one. */
export async function loadGdibl( bytes ) {

	bytes ??= await ( await fetch( new URL( 'gdibl_runtime_c.wasm', import.meta.url ) ) ).arrayBuffer();
	return new Gdibl( ( await WebAssembly.instantiate( bytes ) ).instance.exports );

}

class Gdibl {

	constructor( exports ) {

		this.exports = exports;

	}

	/** A volume from a file's bytes. Throws an Error that says what is wrong where. */
	parse( bytes ) {

		return this.borrow( [ bytes.length, POINTER, MESSAGE_BYTES ], ( file, pointer, message ) => {

			new Uint8Array( this.exports.memory.buffer ).set( bytes, file );
			const status = this.exports.gdibl_parse( file, bytes.length, pointer, message, MESSAGE_BYTES );
			const memory = new Uint8Array( this.exports.memory.buffer );
			if ( status !== 0 ) throw new Error( new TextDecoder().decode( memory.subarray( message, memory.indexOf( 0, message ) ) ) );
			return new Volume( this, new Uint32Array( memory.buffer, pointer, 1 )[ 0 ] );

		} );

	}

	/** What `use( address… )` returns, given as many pieces of the module's memory as there are sizes in bytes. */
	borrow( sizes, use ) {

		const { gdibl_allocate, gdibl_deallocate } = this.exports;
		const addresses = sizes.map( ( size ) => gdibl_allocate( size ) );
		try {

			if ( addresses.includes( 0 ) ) throw new RangeError( `no memory for ${ sizes } bytes` );
			return use( ...addresses );

		} finally {

			addresses.forEach( ( address, k ) => gdibl_deallocate( address, sizes[ k ] ) );

		}

	}

}

class Volume {

	constructor( gdibl, address ) {

		Object.assign( this, { gdibl, address, nodeCount: gdibl.exports.gdibl_node_count( address ) } );
		this.header = gdibl.borrow( [ HEADER_BYTES ], ( at ) => {

			gdibl.exports.gdibl_header( address, at );
			const view = new DataView( gdibl.exports.memory.buffer, at, HEADER_BYTES );
			const three = ( read, start, size ) => [ 0, 1, 2 ].map( ( k ) => view[ read ]( start + k * size, true ) );
			return { kind: KINDS[ view.getUint32( 0, true ) ], counts: three( 'getUint32', 4, 4 ), bands: view.getUint32( 16, true ),
				isDeringed: view.getUint8( 20 ) !== 0, min: three( 'getFloat64', 24, 8 ), max: three( 'getFloat64', 48, 8 ) };

		} );

	}

	/** Irradiance (red, green, blue) at a position with a unit normal. Many at once go faster through irradianceBatch. */
	irradiance( position, normal ) {

		return this.irradianceBatch( position, normal );

	}

	/** Irradiance at positions (x, y, z after x, y, z) with as many normals, into `result`, which is returned. */
	irradianceBatch( positions, normals, result = new Float32Array( positions.length ) ) {

		const { exports } = this.gdibl, length = positions.length, size = FLOAT * length;
		if ( this.address === 0 ) throw new Error( 'the volume was freed' );
		if ( length % 3 !== 0 || normals.length !== length || result.length !== length ) {

			throw new RangeError( `${ length } numbers of positions, ${ normals.length } of normals, ${ result.length } of results` );

		}

		return this.gdibl.borrow( [ size, size ], ( p, n ) => {

			new Float32Array( exports.memory.buffer, p, length ).set( positions );
			new Float32Array( exports.memory.buffer, n, length ).set( normals );
			exports.gdibl_irradiance_batch( this.address, length / 3, p, n, p );
			result.set( new Float32Array( exports.memory.buffer, p, length ) );
			return result;

		} );

	}

	/** Gives the volume's memory back. */
	free() {

		this.gdibl.exports.gdibl_free( this.address );
		this.address = 0;

	}

}
